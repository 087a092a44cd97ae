"""The history encoder and the flow predictor of the document on motion that goes on."""
