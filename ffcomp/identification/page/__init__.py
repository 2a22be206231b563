"""Read a page that a printer drew: a picture, its lines, and the machine that drew them."""
