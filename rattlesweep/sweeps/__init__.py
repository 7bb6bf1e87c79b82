"""Many runs: config, cases, blocks, store, engines."""
