"""From the scene to the flux on the detector: motion, blur, parallax, stray flux."""
