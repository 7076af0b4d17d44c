"""`python -m sphtrunc` is `sphtrunc`."""

from sphtrunc.cli import main

main()
