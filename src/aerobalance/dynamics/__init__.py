"""Models of the balance as a spring: one component, coupled components, condensation and decoupling."""
