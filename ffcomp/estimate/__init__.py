"""How long a print takes as the firmware will plan it, and what it spends that time on."""
