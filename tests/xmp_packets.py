"""XMP packets that note a panorama, in the forms in which programs write them."""

GPANO = "http://ns.google.com/photos/1.0/panorama/"
WHOLE = {
    "ProjectionType": "equirectangular", "FullPanoWidthPixels": 200,
    "CroppedAreaImageWidthPixels": 200, "CroppedAreaImageHeightPixels": 100,
}  # fmt: skip
"""A sphere of 200 x 100 px."""
ATTRIBUTES = ('<rdf:Description rdf:about="" xmlns:{0}="{1}" {2}/>', '{0}:{3}="{4}"')
ELEMENTS = (
    '<rdf:Description rdf:about="a photo" xmlns:{0}="{1}">{2}</rdf:Description>',
    "<{0}:{3}>\n  {4}  \n</{0}:{3}>",
)
QUALIFIED = (
    '<rdf:Description xmlns:{0}="{1}">{2}</rdf:Description>',
    '<{0}:{3} rdf:parseType="Resource"><rdf:value>{4}</rdf:value></{0}:{3}>',
)
APART = ("{2}", '<rdf:Description rdf:about="" xmlns:{0}="{1}" {0}:{3}=\'{4}\'/>')
"""A description for each property."""
FORMS = (ATTRIBUTES, ELEMENTS, QUALIFIED, APART)


def xmp_packet(form=ATTRIBUTES, prefix="GPano", namespace=GPANO, **noted):
    """Return a packet that notes properties of one namespace."""
    whole, each = form
    properties = " ".join(
        each.format(prefix, namespace, "", name, value) for name, value in noted.items()
    )
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f"{whole.format(prefix, namespace, properties)}</rdf:RDF></x:xmpmeta>"
        '<?xpacket end="w"?>'
    )
