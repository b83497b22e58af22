"""``python -m pdpetsc case.py [name=value ...] [-o DIR] [-petsc_option value ...]``."""

from pdpetsc.command_line.cli import main

if __name__ == "__main__":
    main()
