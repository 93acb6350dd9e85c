"""What columns do not do: a window as a store of Oxigraph."""
