"""The command line: a thin shell over the library, sharing its defaults."""
