"""The thesis' control laws, one a file: state in, string force densities out."""
