"""The blind benchmark: hidden printers, their measurements, sealed labels and the score."""
