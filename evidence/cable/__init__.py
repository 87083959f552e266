"""The study of hanging cables (chapter 3): amplitudes, frequencies, whirling, drift, by excitation and by elements."""
