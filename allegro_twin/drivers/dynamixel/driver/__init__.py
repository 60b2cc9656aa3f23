"""The program's side: a backend through the vendor's SDK."""
