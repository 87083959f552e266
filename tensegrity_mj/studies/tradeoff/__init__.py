"""Speed against accuracy: the work-precision diagram of a scene."""
