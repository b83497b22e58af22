"""``python -m pdpetsc case.py [name=value ...] [-o DIR] [-petsc_option value ...]``."""

import os

# One thread per rank, unless the user says otherwise; numpy reads this when it is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from pdpetsc.command_line.cli import main

if __name__ == "__main__":
    main()
