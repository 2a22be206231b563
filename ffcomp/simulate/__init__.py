"""Any command through the virtual printer: G-code as a firmware plays it, or step timings."""
