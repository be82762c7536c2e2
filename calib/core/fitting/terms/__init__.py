"""Joint terms that measurements may ask for: candidates, trials, the choice, and the curves of joints."""
