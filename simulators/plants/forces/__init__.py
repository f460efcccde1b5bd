"""Forces between the car, its carrier, the tool and the mount; each effect has its own switch."""
