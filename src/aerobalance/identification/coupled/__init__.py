"""What releases, taps and a shaken ground end share: free motion of coupled components, its fit and its results."""
