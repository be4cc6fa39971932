"""General numerical methods: filters, spectra, linear algebra, least squares and threads."""
