"""The ontologies in a store: what is loaded, what follows from it, the words it knows, and the live
stream space. `texts` reads them, `entailment` closes them, `ontology` has it all."""
