"""Many recordings of the same sensors, on the cores of one machine or on a cluster."""
