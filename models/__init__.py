"""Tensors and mjModels in and out; knows no message, bus or clock."""
