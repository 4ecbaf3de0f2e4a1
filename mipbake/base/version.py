"""The version of mipbake, for every module that writes it into files."""

__version__ = "0.1.0"
