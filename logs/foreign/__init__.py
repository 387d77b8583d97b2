"""Other people's messages as fieldloc's records: roles of topics, frames, and what each kind of message says."""
