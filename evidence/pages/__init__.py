"""Scripts that write pages and references anew: `python -m evidence.pages.NAME`."""
