"""What crosses each wire: bytes to frozen values and back, without I/O and without a clock."""
