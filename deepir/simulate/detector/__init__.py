"""From flux to data: fixed pattern, defects, noise, thermal lag."""
