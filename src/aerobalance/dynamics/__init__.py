"""The balance as a spring, n x n: one component, independent or coupled ones; condensation and decoupling."""
