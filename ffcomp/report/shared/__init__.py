"""Style, drawing and the page frame of all reports."""
