"""``python -m lightopt``: the command line, where its script is not on the path."""

from lightopt.cli import main

if __name__ == "__main__":
    main()
