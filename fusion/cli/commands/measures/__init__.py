"""Commands that measure answers against truths, and fit what is measured."""
