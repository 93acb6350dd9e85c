// Written by docs/console_questions.py from docs/how-to/ask-the-system.md.
export const QUESTIONS = [
  [
    [
      "Which streams are there, and what do they mean?"
    ],
    [
      "SELECT ?stream ?unit ?feature {\n  ?s a :Stream ; :hasName ?stream\n  OPTIONAL { ?s :isOutput/:hasName ?unit }\n  OPTIONAL { ?s :hasAnnotation/:hasOutputAnnotation/:describesFeature ?feature }\n} ORDER BY ?stream ?feature"
    ]
  ],
  [
    [
      "Which streams have a feature? It is a field"
    ],
    [
      "SELECT ?stream ?feature {\n  ?s a :Stream ; :hasName ?stream ; :hasAnnotation/:hasOutputAnnotation/:describesFeature $feature\n} ORDER BY ?stream ?feature"
    ]
  ],
  [
    [
      "How are streams and units connected, as a graph?"
    ],
    [
      "CONSTRUCT {\n  ?unit :hasInput ?in . ?unit :hasOutput ?out\n} WHERE {\n  ?unit a :ComputationalUnit\n  OPTIONAL { ?unit :hasInput ?in }\n  OPTIONAL { ?unit :hasOutput ?out }\n}"
    ]
  ],
  [
    [
      "Which streams do clients publish to?"
    ],
    [
      "SELECT ?name {\n  ?stream a :Stream ; :hasName ?name\n  FILTER NOT EXISTS { ?stream :isOutput ?unit }\n  FILTER (?name != \"status\")\n} ORDER BY ?name"
    ]
  ],
  [
    [
      "Which units run, and what are they instances of?"
    ],
    [
      "SELECT ?unit ?transformation {\n  ?u a :ComputationalUnit ; :hasName ?unit ; :instantiationOf ?transformation\n} ORDER BY ?unit"
    ]
  ],
  [
    [
      "What does the join read and make?"
    ],
    [
      "SELECT ?input ?output {\n  ?unit :instantiationOf :join ; :hasInput/:hasName ?input ; :hasOutput/:hasName ?output\n} ORDER BY ?input"
    ]
  ],
  [
    [
      "Which units feed the event?"
    ],
    [
      "SELECT ?unit ?transformation {\n  ?event :isOutput [ :instantiationOf :cSparql ] ; :isOutput/(:hasInput/:isOutput)* ?u .\n  ?u :hasName ?unit ; :instantiationOf ?transformation\n} ORDER BY ?unit"
    ]
  ],
  [
    [
      "What breaks if ",
      "gps",
      " stops?"
    ],
    [
      "SELECT ?name { :",
      "gps",
      " (:isInput/:hasOutput)+/:hasName ?name } ORDER BY ?name"
    ]
  ],
  [
    [
      "Which units are between ",
      "gps",
      " and ",
      "out",
      "?"
    ],
    [
      "SELECT ?unit {\n  :",
      "gps",
      " (:isInput/:hasOutput)*/:isInput ?u .\n  ?u :hasOutput/(:isInput/:hasOutput)* :",
      "out",
      " ; :hasName ?unit\n} ORDER BY ?unit"
    ]
  ],
  [
    [
      "What are the first origins of ",
      "out",
      "?"
    ],
    [
      "PREFIX prov: <http://www.w3.org/ns/prov#>\nSELECT ?name {\n  :",
      "out",
      " (prov:wasGeneratedBy/prov:used)+ ?origin .\n  ?origin :hasName ?name\n  FILTER NOT EXISTS { ?origin prov:wasGeneratedBy ?unit }\n} ORDER BY ?name"
    ]
  ],
  [
    [
      "Which streams does no unit read?"
    ],
    [
      "SELECT ?name {\n  ?stream a :Stream ; :hasName ?name\n  FILTER NOT EXISTS { ?stream :isInput ?unit }\n} ORDER BY ?name"
    ]
  ],
  [
    [
      "Which units read more than one stream?"
    ],
    [
      "SELECT ?unit (COUNT(?input) AS ?inputs) {\n  ?u :hasName ?unit ; :hasInput ?input\n} GROUP BY ?unit HAVING (COUNT(?input) > 1)"
    ]
  ],
  [
    [
      "How was ",
      "both",
      " made?"
    ],
    [
      "SELECT ?text { :",
      "both",
      " :isOutput/:hasSpecification/:hasName ?text }"
    ]
  ],
  [
    [
      "Which streams keep a policy, and which?"
    ],
    [
      "SELECT ?stream ?policy {\n  ?s :hasName ?stream ; :hasPolicy/:hasText ?policy\n} ORDER BY ?policy"
    ]
  ],
  [
    [
      "How many read each stream?"
    ],
    [
      "SELECT ?name ?readers {\n  ?stream :hasName ?name ; :hasSubscriberCount ?readers\n  FILTER (?readers > 0)\n} ORDER BY ?name"
    ]
  ],
  [
    [
      "Which transformations give dyknow:speed?"
    ],
    [
      "SELECT ?name ?cost ?quality {\n  ?t a :Transformation ; :hasName ?name ; :hasCost ?cost ; :hasQuality ?quality ;\n     :hasAnnotation/:hasOutputAnnotation/:describesFeature dyknow:speed\n}"
    ]
  ],
  [
    [
      "What does coordinatesToSpeed need, in order?"
    ],
    [
      "SELECT ?first ?second {\n  :coordinatesToSpeed :hasAnnotation/:hasInputAnnotation ?one .\n  ?one :describesFeature ?first ; :nextSegment/:hasInputAnnotation/:describesFeature ?second\n}"
    ]
  ],
  [
    [
      "Which streams contain dyknow:altitude, and in which unit?"
    ],
    [
      "SELECT ?name ?unit {\n  ?stream a :Stream ; :hasName ?name ; :hasAnnotation/:hasOutputAnnotation ?content .\n  ?content :describesFeature dyknow:altitude ; :hasUnit ?unit\n}"
    ]
  ],
  [
    [
      "Which streams speak of UAVs of any kind?"
    ],
    [
      "SELECT DISTINCT ?name ?sort {\n  ?stream a :Stream ; :hasName ?name ; :hasAnnotation/:hasOutputAnnotation/:describesSort ?sort .\n  ?sort rdfs:subClassOf* dyknow:UAV\n  FILTER NOT EXISTS { ?stream :isOutput ?unit }\n} ORDER BY ?name"
    ]
  ],
  [
    [
      "Which features does no annotated stream contain?"
    ],
    [
      "SELECT ?feature {\n  ?feature a :Feature ; :hasUnit ?unit\n  FILTER NOT EXISTS { ?s a :Stream ; :hasAnnotation/:hasOutputAnnotation/:describesFeature ?feature }\n} ORDER BY ?feature"
    ]
  ],
  [
    [
      "What is the unit of dyknow:speed in QUDT and UCUM?"
    ],
    [
      "PREFIX skos: <http://www.w3.org/2004/02/skos/core#>\nPREFIX qudt: <http://qudt.org/schema/qudt/>\nSELECT ?qudt ?ucum {\n  dyknow:speed :hasUnit ?text .\n  ?unit :hasName ?text ; skos:exactMatch ?qudt ; qudt:ucumCode ?ucum\n}"
    ]
  ],
  [
    [
      "Which events can be asked for?"
    ],
    [
      "SELECT ?event { ?event a :EventTemplate }"
    ]
  ],
  [
    [
      "Which events are detected now, and by which query?"
    ],
    [
      "SELECT ?stream ?line {\n  ?unit :instantiationOf :cSparql ; :hasOutput/:hasName ?stream ; :hasSpecification/:hasName ?query\n  BIND (STRBEFORE(?query, \"\\n\") AS ?line)\n}"
    ]
  ]
];
