"""Run the command line: `python -m ffcomp`."""

from ffcomp.cli.app import main

if __name__ == "__main__":
    main()
