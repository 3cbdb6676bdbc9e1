"""The benchmarks, a module each, and the code that only they use."""
