"""What is read from files and arguments: text, tables and YAML become checked objects, or one error."""
