"""The one place that ties renderer, store, planner, photo and matcher together."""
