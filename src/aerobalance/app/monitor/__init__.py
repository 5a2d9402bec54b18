"""The operator's page: live charts, records and results in a browser. No maths in it: it calls the core.

Four kinds of process: the source and the recorder (`aerobalance.acquisition`), the engine that follows the source and
works out what is shown (`engine`), and the server that hands it to the viewers (`server`). What a viewer, the server
or the engine does never holds up the source or a record.
"""
