"""Compiled pieces that engines and laws share: addresses, the string law, actuation, loads. No model of a rod."""
