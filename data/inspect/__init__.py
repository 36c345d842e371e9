"""Looking at a dataset of drapes: is it whole, and does it look as it should?"""
