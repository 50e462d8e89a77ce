"""Names of the digests among an output's MIME types."""

FIGURE_TYPE = "application/vnd.nbregress.figure+json"
DATA_TYPE = "application/vnd.nbregress.data+json"
WIDGET_TYPE = "application/vnd.nbregress.widget+json"
WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
#: All digests; beside one, no picture, HTML or plain text of an output is compared.
DIGESTS = (FIGURE_TYPE, DATA_TYPE, WIDGET_TYPE)
