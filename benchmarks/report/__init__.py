"""Results as goals, tables, a figure and the page docs/performance.md."""
