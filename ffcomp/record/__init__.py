"""Recordings from a real printer: moves that are worth recording, and captures joined with their command."""
