"""`python -m tests.golden --update`."""

import sys

from tests.golden import update

if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit("usage: python -m tests.golden --update")
    for path in update():
        sys.stdout.write(f"changed: {path}\n")
