"""`python -m quadlog`: the same program as `quadlog`."""

from quadlog.cli.main import main

if __name__ == "__main__":
    main()
