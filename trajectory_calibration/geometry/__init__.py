"""Arrays of SE(3) and how to interpolate them; it knows no sensor."""
