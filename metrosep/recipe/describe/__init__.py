"""What a result says of itself in documents, charts and reports, and what the steps take."""
