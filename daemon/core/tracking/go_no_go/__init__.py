"""Decision before contact: whether the tool may go on to the object."""
