"""Touch alone measured."""
