"""The page of the tree builder: viser's controls and scene over the drafts and edits of `station.builder`.

All of it runs in the one event loop of viser's server, in the order in which things were clicked: no locks. What is
shown follows from one `Desk` and a few choices, such as the selected part; each action makes a new desk, and
everything that shows it is brought up to date. All tabs of all browsers show the same draft.
"""
