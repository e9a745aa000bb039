"""What tries to break the package: cases by theme, damage of files, and readers of every format."""
