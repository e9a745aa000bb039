"""Registration methods of papers and libraries, to compare with."""
