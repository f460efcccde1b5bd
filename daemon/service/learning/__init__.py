"""What good assemblies teach, and how it becomes parameters."""
