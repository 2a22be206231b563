"""Turn G-code text into moves and back; no physics, no machine."""
