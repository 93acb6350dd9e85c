# The examples of docs/reference/http.md, by its sections; docs/http_reference.py puts them there.

## Start
URL=http://127.0.0.1:8000

## Sessions
curl $URL/session

## Streams and samples
curl -X PUT $URL/streams/s5 -H 'Content-Type: application/json' -d '{
  "fields": [{"name": "id", "type": "string"}, {"name": "spd", "type": "float"}],
  "lateness": "5s", "idle": "30s", "ahead": "1h", "retention": {"samples": 100000, "age": "1h", "bytes": 100000000},
  "namespace": "http://www.ida.liu.se/dyknow/"}'
curl $URL/streams/s5/samples -H 'Content-Type: application/x-ndjson' -H 'Idempotency-Key: 1' \
  --data-binary $'{"valid": "2021-10-07T19:12:53Z", "id": "uav1", "spd": 31.5}\n'
curl "$URL/streams/s5/samples?limit=10" -H 'Accept: text/csv'
curl "$URL/streams/s5/samples?every=10s&fields=spd" -H 'Accept: text/csv'   # minimum, maximum, last
curl -X POST $URL/streams/s5/end
printf '%s\n' '{"valid": "2021-10-07T19:12:54Z", "id": "uav1", "spd": 32}' \
  '{"valid": "2021-10-07T19:12:55Z", "id": "uav1", "spd": 32.5}' |
  curl $URL/streams/s5/samples/live -H 'Content-Type: application/x-ndjson' -X POST -T -
curl -X POST $URL/streams/s5/end
curl "$URL/streams?fields=name,rate,silent_for&changed=start" -i   # Dyknow-Position is the next `changed`
curl $URL/streams/s5_late
curl $URL/streams/s5_late/samples
curl -X DELETE $URL/streams/s5_late
curl -N $URL/streams/s5/events              # from now on
curl -N "$URL/streams/s5/events?since=start"   # everything that is kept, then on
curl -N "$URL/streams/s5/events?since=30s"     # the last 30 seconds of the stream, then on
curl -N $URL/streams/s5/events -H 'Last-Event-ID: 3f2a91c0-120'
curl -N "$URL/streams/s5/events?last=100&rdf=no&fields=id,spd&every=250ms"   # the newest of each object

## Subscriptions
curl $URL/subscriptions -H 'Content-Type: application/json' \
  -d '{"stream": "s5", "policy": "monotone order, max delay 2s", "since": "start"}'
curl $URL/subscriptions/subscription1
curl -X DELETE $URL/subscriptions/subscription1
curl $URL/subscriptions -H 'Content-Type: application/json' -d '{"feature": "dyknow:speed",
  "sort": "dyknow:UAV", "strategy": "quality", "staleness": "5s", "min_quality": 0.5, "hold_off": "2s"}'
curl $URL/subscriptions/subscription2/rematches
curl "$URL/graph?around=subscription2"       # what feeds it
curl -X DELETE $URL/subscriptions/subscription2

## KPL
curl $URL/kpl -H 'Content-Type: text/plain' -d '
  source float pos_car1
  strmgen pos[car1] = pos_car1
  stream slow = pos[car1] with sample every 200, max delay 100'
curl $URL/streams/pos_car1/samples -H 'Content-Type: application/x-ndjson' \
  -d '{"valid": 200000000, "available": 280000000, "value": 31.5}'
curl $URL/streams/slow/samples
curl $URL/streams/slow_violations/samples
curl -g "$URL/kpl/pos[car1]"
curl -X DELETE "$URL/kpl/pos_car1?cascade=true"

## Specifications
curl -X PUT $URL/streams/positions -H 'Content-Type: application/json' \
  -d '{"fields": {"id": "string", "latitude": "float", "longitude": "float"}}'
curl $URL/specifications -H 'Content-Type: application/xml' -d '
  <spec:specification xmlns:spec="http://www.dyknow.eu/ontology#Specification">
    <spec:insertions><spec:cu name="speeds" type="coordinatesToSpeed">
      <spec:stream name="positions"/></spec:cu></spec:insertions>
  </spec:specification>'
curl $URL/specifications/current

## Meaning
curl $URL/ontologies -H 'Content-Type: text/turtle' -d '
  @prefix dyknow: <http://www.ida.liu.se/dyknow/> .
  @prefix owl: <http://www.w3.org/2002/07/owl#> .
  @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
  <http://example.org/harbour> a owl:Ontology .
  dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle .'
curl $URL/ontologies/http%3A%2F%2Fexample.org%2Fharbour
curl -X DELETE $URL/ontologies/http%3A%2F%2Fexample.org%2Fharbour
curl $URL/annotations -H 'Content-Type: text/plain' \
  -d 'stream s5 contains speed(UAV) = spd [m.s-1] for every UAV = id'
curl $URL/annotations -H 'Content-Type: application/json' -d '{"stream": "s6", "contents": [
  {"feature": "dyknow:altitude", "field": "alt", "unit": "m", "of": [{"name": "dyknow:UAV", "id": "id"}]}]}'
curl "$URL/objects?sort=dyknow:UAV&limit=10"
curl $URL/objects/uav1
curl -X PUT $URL/streams/s6/quality -H 'Content-Type: application/json' -d '{"quality": 0.5}'
curl $URL/transformations -H 'Content-Type: application/json' -d '{
  "annotation": "compunit speedOver10s transforms lat:latitude, lon:longitude to spd:speed [m.s-1]",
  "implementation": "coordinatesToSpeed", "parameters": {"baseline": "10s"}, "cost": 2, "quality": 0.9}'
curl -X PATCH $URL/transformations/speedOver10s -H 'Content-Type: application/json' -d '{"cost": 3}'
curl -X DELETE $URL/transformations/speedOver10s
curl $URL/match -H 'Content-Type: application/json' -d '{"feature": "dyknow:speed", "sort": "dyknow:UAV"}'
curl $URL/match -H 'Content-Type: application/json' -d '{"feature": "dyknow:distance",
  "objects": ["dyknow:car1", "dyknow:car2"], "strategy": "weighted:cost=1,quality=10"}'
curl -G $URL/explain --data-urlencode 'feature=dyknow:speed' --data-urlencode 'sort=dyknow:UAV'
curl -G $URL/sparql --data-urlencode 'query=PREFIX d: <http://www.dyknow.eu/ontology#>
  SELECT ?name { ?s a d:Stream ; d:hasName ?name }' -H 'Accept: text/csv'
curl "$URL/sparql?default-graph-uri=http://example.org/harbour" -H 'Accept: application/rdf+xml' \
  -H 'Content-Type: application/sparql-query' -d 'CONSTRUCT WHERE { ?sort a owl:Class }'
curl $URL/sparql

## Events on demand
curl $URL/templates -H 'Content-Type: text/plain' --data-binary @templates/library/high_speed.rq
curl -G $URL/explain --data-urlencode 'event=dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'
curl $URL/events -H 'Content-Type: application/json' -d '{"event": "dyknow:HighSpeedEvent",
  "arguments": ["?o", "dyknow:UAV", "100"], "strategy": "fast"}'
curl $URL/events -H 'Content-Type: text/plain' -d 'dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'
EVENTS=$(curl $URL/events -H 'Content-Type: application/json' -d '{"event": "dyknow:HighSpeedEvent",
  "arguments": ["?o", "dyknow:UAV", "100"], "since": "start"}' |
  python3 -c 'import json, sys; print(json.load(sys.stdin)["events"])')
curl -N "$URL$EVENTS?since=start"
curl "$URL/events?since=30s" -H 'Content-Type: text/plain' -d 'dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)'
curl -N "$URL$EVENTS?since=start"

## Queries
curl "$URL/queries?since=start" -H 'Content-Type: text/plain' -d '
  REGISTER STREAM fast COMPUTE EVERY 1s AS
  CONSTRUCT { ?o dyknow:speed ?mean }
  FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 5s STEP 1s]
  WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v . }
  AGGREGATE {(?mean, AVG, {?v}) FILTER (?mean > 100)}'
curl -G $URL/queries/fast --data-urlencode explain=true -H 'Accept: text/plain'
curl $URL/queries/fast/results -H 'Accept: text/turtle'
curl "$URL/queries?bounds=%5B)&report=close&since=start" -H 'Content-Type: application/sparql-query' -d '
  REGISTER QUERY means AS SELECT ?o (AVG(?v) AS ?mean)
  WHERE { ?o a dyknow:UAV ; dyknow:speed ?v } GROUP BY ?o WINDOW [RANGE 5s STEP 5s]'
curl "$URL/queries/means/results?limit=10" -H 'Accept: text/csv'
curl "$URL/streams/fast/samples"
curl -X DELETE $URL/queries/fast
curl -X DELETE $URL/queries/means

## The service
curl $URL/status
curl "$URL/requests?status=400&limit=20"
curl $URL/journal
curl $URL/healthz
