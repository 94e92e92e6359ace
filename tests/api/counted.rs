//! Scenes whose elements are counted by who uploads them.

use serde_json::Value;

use super::durable::start;
use super::glb;
use super::server::{Server, path_of};

async fn uploaded(server: &Server, query: &str) -> Value {
    server.post_glb(&format!("/v1/scenes?bake=false&{query}"), glb::room().bytes()).await.json(201)
}

#[tokio::test]
async fn elements_are_nearly_as_many_as_asked_for_and_stay_so() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    let mut kept = Vec::new();
    for asked in [500, 4000, 30_000] {
        let query = format!("elements={asked}");
        let plan = server.post_glb(&format!("/v1/scenes?dry_run=true&{query}"), glb::room().bytes()).await.json(200);
        let scene = uploaded(&server, &query).await;
        let count = scene["live_elements"].as_u64().unwrap();
        assert!(count <= asked && 10 * count > 8 * asked, "{asked}: {count}");
        assert_eq!((&plan["elements"], &plan["spacing"]), (&scene["live_elements"], &scene["spacing"]));
        assert_eq!(scene["warnings"], serde_json::json!([]));
        kept.push(scene);
    }
    // Where the file has more vertices, and of one that was asked for by its spacing.
    kept.push(uploaded(&server, "elements=8").await);
    kept.push(uploaded(&server, "spacing=0.5").await);
    let (count, warning) = (kept[3]["live_elements"].as_u64().unwrap(), kept[3]["warnings"][0].as_str().unwrap());
    assert!(count > 8 && warning.contains(&format!("{count} elements")) && warning.contains('8'), "{warning}");
    // By light, as many as asked for; and where nothing is farther apart than a spacing, more than that spacing has.
    for (query, even) in [("elements=4000", kept[1].clone()), ("spacing=0.5", kept[4].clone())] {
        let scene = uploaded(&server, &format!("{query}&sizing=light")).await;
        let [count, even] = [&scene, &even].map(|scene| scene["live_elements"].as_f64().unwrap());
        assert!((0.9..1.7).contains(&(count / even)) && count != even, "{query}: {count} {even}");
        assert_eq!((&scene["sizing"], &kept[1]["sizing"]), (&"light".into(), &"uniform".into()));
        kept.push(scene);
    }
    server.stop().await;
    let server = start(directory.path()).await;
    for scene in &kept {
        let again = server.get(&path_of(scene)).await.json(200);
        for field in ["live_elements", "spacing", "sizing", "warnings", "objects"] {
            assert_eq!(again[field], scene[field], "{field}");
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn counts_that_cannot_be_are_refused() {
    let server = Server::with(|config| config.limits.elements = 20_000).await;
    for query in ["elements=0", "elements=-3", "elements=x", "elements=20001", "elements=500&spacing=0.1"] {
        let path = format!("/v1/scenes?{query}");
        let told = server.post_glb(&path, glb::room().bytes()).await.problem(400, "invalid-query");
        assert!(told.contains("elements"), "{query}: {told}");
    }
    server.stop().await;
}
