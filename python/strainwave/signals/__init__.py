"""Logs -> signals for identification: motor side, link side, channel delays and consistency."""
