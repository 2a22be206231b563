"""The blind bank: hidden printers, their measurements, sealed labels and the score."""
