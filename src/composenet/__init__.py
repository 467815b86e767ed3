"""ComPoseNet: completed, posed and tracked objects from RGB-D video."""

__version__ = "0.1.0"
