"""What is drawn in 3-D: robot and bridge as meshes, how they bend, and from where they are seen."""
