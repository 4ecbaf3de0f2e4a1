"""`python -m mipbake`: the command line, where the command `mipbake` is not on the path."""

from mipbake_start import run

if __name__ == "__main__":
    run()
