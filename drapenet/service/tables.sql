-- The service's database. An estimate's files are in the folder of its id. A joint estimate has
-- members, JSON of the ids of the captures that it joins; task is what a worker needs.
PRAGMA journal_mode = WAL;
PRAGMA synchronous = FULL;
PRAGMA foreign_keys = ON;
CREATE TABLE IF NOT EXISTS fabric (
    id TEXT PRIMARY KEY, name TEXT NOT NULL, notes TEXT NOT NULL, created REAL NOT NULL);
CREATE TABLE IF NOT EXISTS estimate (
    id TEXT PRIMARY KEY, fabric TEXT NOT NULL REFERENCES fabric ON DELETE CASCADE,
    name TEXT NOT NULL, state TEXT NOT NULL, stage TEXT, error TEXT,
    warnings TEXT NOT NULL DEFAULT '[]', estimate TEXT, curves TEXT, members TEXT, task TEXT,
    tries INTEGER NOT NULL DEFAULT 0, created REAL NOT NULL, ended REAL);
-- Of an estimate, whose id it has: the preview of a garment.
CREATE TABLE IF NOT EXISTS garment (
    id TEXT PRIMARY KEY REFERENCES estimate ON DELETE CASCADE,
    state TEXT NOT NULL, progress TEXT, error TEXT);
CREATE INDEX IF NOT EXISTS estimate_fabric ON estimate (fabric);
-- The result of a fabric is its joint or else its latest estimate, from a drape if there is one;
-- words are searched.
CREATE VIEW IF NOT EXISTS overview AS
SELECT f.*, e.id AS result,
    json_remove(e.estimate, '$.correlations', '$.torque_mN', '$.moduli_at_300_g_m2',
        '$.share_of_spread_over_fabrics', '$.captures', '$.warnings') AS estimate,
    (SELECT count(*) FROM estimate WHERE fabric = f.id AND members IS NULL) AS captures,
    (SELECT error FROM estimate WHERE fabric = f.id AND members IS NOT NULL) AS apart,
    f.name || ' ' || f.notes || ' ' || coalesce((
        SELECT group_concat(name || ' ' || coalesce(json_extract(estimate, '$.capture.rig'), ''), ' ')
        FROM estimate WHERE fabric = f.id), '') AS words
FROM fabric f LEFT JOIN estimate e ON e.id = (
    SELECT id FROM estimate WHERE fabric = f.id AND state = 'done'
    ORDER BY members IS NULL, coalesce(json_extract(estimate, '$.capture.rig'), '') = '',
        created DESC LIMIT 1);
-- Fabrics without unfinished estimates, and the time of their last event.
CREATE VIEW IF NOT EXISTS settled AS
SELECT f.id, max(f.created, coalesce(max(e.ended), 0)) AS latest
FROM fabric f LEFT JOIN estimate e ON e.fabric = f.id GROUP BY f.id
HAVING coalesce(sum(e.state NOT IN ('done', 'failed', 'interrupted')), 0) = 0;
