"""The figures the README quotes."""
