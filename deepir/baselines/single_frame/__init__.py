"""Methods that correct each frame by itself; its frames are then registered and averaged."""
