"""Where trajectories come from: files and bags here; live buffers in ``ros``."""
