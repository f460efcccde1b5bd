"""Judgement of runs by the plant's truth: figures, tables and reports."""
