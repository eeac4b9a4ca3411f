"""Any log becomes a stream of typed messages."""
