"""Every setting, its range, its default and its help text; priors; YAML files."""
