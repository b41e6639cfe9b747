"""What a person or another program gets of a result."""
