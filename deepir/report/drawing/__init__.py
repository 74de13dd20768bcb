"""Maps, curves and their scales, by Pillow: matplotlib takes longer to import and to draw than a small solve."""
