"""The local page of `ffcomp serve`: files come in, each verb runs as a process of its own, files go out."""
