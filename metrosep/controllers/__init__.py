"""The controllers layer."""
