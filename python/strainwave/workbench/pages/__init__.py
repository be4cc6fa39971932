"""The pages: each module answers the requests of one or two pages, with their views."""
