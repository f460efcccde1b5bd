"""KUKA RSI: telegrams, replies and the configuration file, as bytes and frozen values."""
