"""The history encoder and the flow predictor of autoregressive flow matching."""
