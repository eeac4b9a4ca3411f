"""The compiled searches under the planners."""
