"""Entry point of `python -m rattlesweep`."""

from rattlesweep.cli import main

if __name__ == "__main__":
    main(prog_name="rattlesweep")
