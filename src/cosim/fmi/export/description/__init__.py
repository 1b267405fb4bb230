"""`modelDescription.xml`, `buildDescription.xml` and the page about the model."""
