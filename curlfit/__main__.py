"""`python -m curlfit`."""

from curlfit.cli import main

main()
