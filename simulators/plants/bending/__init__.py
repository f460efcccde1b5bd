"""What a real arm does between its drives, its encoders and its flange."""
