"""Two clocks become one: offset, drift, interpolation, pairing."""
