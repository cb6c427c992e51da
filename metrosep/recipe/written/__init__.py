"""The text of a recipe: recipes that it builds on, values that a caller overrides."""
