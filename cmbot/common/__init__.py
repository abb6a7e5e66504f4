"""What every room uses: errors, array types, checked input, resources.

Import from its modules: ``import cmbot`` loads the errors and nothing heavy, so nothing is imported here.
"""

from cmbot.common.lazy_imports import on_first_use

# It has a name that is documented.
__getattr__ = on_first_use(__name__, ("eta",))
