"""State the version, once: the package metadata and every output read it here."""

__version__ = "0.1.0"
