"""Which topic plays which role, and why; what would make the others of use."""
