"""Foreign files in and out, one module a format; the only place with units other than SI."""
