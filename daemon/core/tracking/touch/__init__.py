"""Touch: contact detection, guarded approach, and release of the clamp."""
