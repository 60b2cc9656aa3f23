"""Commands that convert recordings and write file schemas."""
