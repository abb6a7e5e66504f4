"""What every room uses: errors, array types, checked input, resources.

Import from its modules: ``import cmbot`` loads the errors and nothing heavy, so this door is empty.
"""
