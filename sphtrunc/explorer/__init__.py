"""The explorer: one self-contained page that computes truncation errors in a browser.

`tables` says exactly what the page knows (kernels, lattices, forms, best paths), `assembly` puts it
together with the sources in `page/`, and `setting` gives the numbers of a setting of the page from
the theory of this package, which is what the page's own numbers are tested against.
"""
