"""What every room uses: errors, array types, checked input, resources."""
