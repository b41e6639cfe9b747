"""What flows: trajectories, pairs of poses at common times, relative motions."""
