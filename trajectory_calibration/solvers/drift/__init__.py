"""The parts of the drift-aware solver."""
