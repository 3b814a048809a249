"""Prior distributions, and the files that state them. What data say of a parameter is not here."""
