"""A file through the planner, the inverse and the writer."""
