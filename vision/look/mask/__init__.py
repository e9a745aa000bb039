"""Which pixels show the object, and what is told from it before: tables, walls, and pieces of the image."""
