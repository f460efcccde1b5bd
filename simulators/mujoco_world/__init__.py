"""Second, independent emulated station: multibody dynamics and contact solved by MuJoCo."""
