"""What differs from firmware to firmware: its plan, its limits, and the segments that it executes."""
