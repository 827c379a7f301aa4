//! Every page over an API fixture: it answers, it escapes, it loads nothing from elsewhere.

pub(super) mod fixture;

use std::collections::BTreeSet;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode, header};
use jiff::Timestamp;
use lightshaft_api::settings::{
    Acceleration, CameraChoice, Environment, EnvironmentMap, Ground, Integrator, LineSpace, RenderSettings, Split,
};
use serde_json::Value;
use tower::ServiceExt;

use super::assets::Assets;
use super::client::{escape, with_query};
use super::filters::{human_ago, human_bytes, human_count, human_number, human_seconds, human_short, prose_html};
use super::form::{self, Control, Field};
use super::jobs::Filter;
use super::page::CONTENT_SECURITY_POLICY;
use super::router;

struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: String,
}

async fn get_from(scenes: bool, path: &str, headers: &[(&str, &str)]) -> Answer {
    let mut request = Request::get(path).header(header::HOST, "farm.example:8080");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let request = request.body(Body::empty()).expect("a request");
    let response = router(fixture::api(scenes)).oneshot(request).await.expect("an answer");
    let (parts, body) = response.into_parts();
    let body = axum::body::to_bytes(body, usize::MAX).await.expect("a body");
    Answer { status: parts.status, headers: parts.headers, body: String::from_utf8(body.to_vec()).expect("UTF-8") }
}

async fn get(path: &str) -> Answer {
    get_from(true, path, &[]).await
}

fn pages() -> Vec<String> {
    let mut pages = ["/", "/jobs", "/jobs?state=failed&scene=s1&label=a%3Db", "/jobs/new", "/jobs/new?scene=s1"]
        .map(str::to_owned)
        .to_vec();
    pages.extend(["queued", "running", "succeeded", "failed", "cancelled"].map(|state| format!("/jobs/j-{state}")));
    pages.extend(["/jobs/new?from=j-succeeded", "/scenes", "/scenes/s1", "/workers", "/docs"].map(str::to_owned));
    pages.extend(
        ["/farm", "/farm?suite=generated&ok=false", "/farm/runs/r1", "/farm/runs/r1?show=changed"].map(str::to_owned),
    );
    pages.extend(["/farm/history?suite=generated&case=cornell", "/farm/decisions?kind=rejected"].map(str::to_owned));
    pages.push(format!("/meshes/{}", fixture::HASH));
    pages.extend(
        ["/queue", "/meshes", "/farm/schedules", "/benchmarks", "/benchmarks?by=line_space.n"].map(str::to_owned),
    );
    pages.extend(["/farm/webhooks", "/farm/webhooks/w1"].map(str::to_owned));
    pages.extend(
        ["/compare", "/compare?p=j-succeeded", "/compare?p=j-succeeded&p=j-succeeded/image.png"].map(str::to_owned),
    );
    pages.push(format!("/compare?p={}&p=j-succeeded&mode=swipe", fixture::HASH));
    pages
}

#[tokio::test]
async fn every_page_is_html_under_the_content_security_policy() {
    for path in pages() {
        let answer = get(&path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}: {}", answer.body);
        assert_eq!(answer.headers[header::CONTENT_TYPE], "text/html; charset=utf-8", "{path}");
        assert_eq!(answer.headers[header::CONTENT_SECURITY_POLICY], CONTENT_SECURITY_POLICY, "{path}");
        assert_eq!(answer.headers[header::CACHE_CONTROL], "no-cache", "{path}");
        assert!(answer.body.starts_with("<!doctype html>"), "{path}");
    }
}

#[tokio::test]
async fn every_page_works_on_an_empty_service() {
    let pages = ["/", "/jobs", "/jobs/new", "/queue", "/scenes", "/meshes", "/workers", "/compare", "/benchmarks"];
    for path in pages.into_iter().chain(["/farm", "/farm/decisions", "/farm/schedules", "/farm/webhooks"]) {
        let answer = get_from(false, path, &[]).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}: {}", answer.body);
    }
    let overview = get_from(false, "/", &[]).await.body;
    assert!(overview.contains("curl -F file=@scene.glb http://farm.example:8080/v1/scenes"), "{overview}");
}

#[tokio::test]
async fn what_users_wrote_is_escaped() {
    for path in pages() {
        let body = get(&path).await.body;
        for raw in [
            "Ada <b>",
            "1db641f <b>",
            "<i>so</i>",
            "commit <b>",
            "bunnies <script>",
            "<i>left</i>",
            "body <b>",
            "nightly & more",
        ] {
            assert!(!body.contains(raw), "{path} holds {raw:?} unescaped");
        }
    }
    let job = get("/jobs/j-failed").await.body;
    assert!(job.contains("64 bunnies &#60;script&#62;"), "the name is there, escaped");
}

#[tokio::test]
async fn nothing_is_inline_and_nothing_comes_from_elsewhere() {
    for path in pages() {
        let body = get(&path).await.body;
        for forbidden in [" style=\"", " onclick=", " onload=", " onerror=", "<style", "javascript:"] {
            assert!(!body.contains(forbidden), "{path} holds {forbidden}");
        }
        assert!(body.matches("<script").all(|_| true) && !body.contains("<script>"), "{path} has an inline script");
        for piece in body.split("src=\"").skip(1).chain(body.split("href=\"").skip(1)) {
            let target = piece.split('"').next().unwrap_or_default();
            assert!(target.starts_with('/') || target.starts_with('#'), "{path} refers to {target}");
        }
    }
}

#[test]
fn assets_name_no_other_host() {
    for name in Assets::iter() {
        let file = Assets::get(&name).expect("an embedded file");
        let text = String::from_utf8(file.data.into_owned()).expect("text");
        let text = text.replace("http://www.w3.org/2000/svg", "");
        for forbidden in ["http://", "https://", "//cdn", "@import"] {
            assert!(!text.contains(forbidden), "{name} holds {forbidden}");
        }
    }
}

#[tokio::test]
async fn every_asset_that_a_page_or_module_names_is_served() {
    let page = get("/").await.body;
    let version = page.split("/assets/").nth(1).and_then(|rest| rest.split('/').next()).expect("a version").to_owned();
    let mut named: BTreeSet<String> =
        page.split("/assets/").skip(1).map(|rest| rest.split('"').next().unwrap_or_default().to_owned()).collect();
    for name in Assets::iter().filter(|name| name.ends_with(".js")) {
        let text = String::from_utf8(Assets::get(&name).expect("a file").data.into_owned()).expect("text");
        let imports =
            text.split(" from './").skip(1).map(|rest| rest.split('\'').next().unwrap_or_default().to_owned());
        named.extend(imports.map(|module| format!("{version}/{module}")));
    }
    assert!(named.len() >= Assets::iter().count(), "an asset is used by nothing: {named:?}");
    for name in named {
        let answer = get(&format!("/assets/{name}")).await;
        assert_eq!(answer.status, StatusCode::OK, "{name}");
        assert_eq!(answer.headers[header::CACHE_CONTROL], "public, max-age=31536000, immutable", "{name}");
        let media_type = answer.headers[header::CONTENT_TYPE].to_str().expect("text");
        let wanted = match name.rsplit('.').next() {
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            _ => "image/svg+xml",
        };
        assert_eq!(media_type, wanted, "{name}");
    }
}

#[tokio::test]
async fn assets_answer_conditional_requests_and_old_versions() {
    let page = get("/").await.body;
    let path =
        format!("/assets/{}", page.split("/assets/").nth(1).and_then(|rest| rest.split('"').next()).expect("one"));
    let first = get(&path).await;
    let etag = first.headers[header::ETAG].to_str().expect("text").to_owned();
    let again = get_from(true, &path, &[("if-none-match", &etag)]).await;
    assert_eq!(again.status, StatusCode::NOT_MODIFIED);
    assert!(again.body.is_empty());
    let old = get("/assets/0000000000000000/base.css").await;
    assert_eq!((old.status, &old.headers[header::CACHE_CONTROL]), (StatusCode::OK, &"no-cache".parse().expect("text")));
    assert_eq!(get("/assets/0000000000000000/nothing.css").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn unknown_ids_are_html_pages_with_the_status_of_the_api() {
    for path in [
        "/farm/runs/nothing",
        "/compare?p=nothing",
        "/jobs/nothing",
        "/scenes/nothing",
        "/meshes/nothing",
        "/jobs/new?scene=nothing",
        "/jobs/a%2Fb%3Fc",
    ] {
        let answer = get(path).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{path}");
        assert!(answer.body.contains("there is no "), "{path}: {}", answer.body);
        assert!(answer.headers[header::CONTENT_TYPE].to_str().expect("text").starts_with("text/html"), "{path}");
    }
}

#[tokio::test]
async fn a_job_page_shows_what_is_known_of_it() {
    let done = get("/jobs/j-succeeded").await.body;
    for part in ["/v1/jobs/j-succeeded/artifacts/image.png", "2.43", "MRays/s", "403 KiB", "Shadow", "built", "12.3 s"]
    {
        assert!(done.contains(part), "no {part}");
    }
    assert!(!done.contains("data-events"), "a finished job has no events");
    let running = get("/jobs/j-running").await.body;
    assert!(running.contains("data-events=\"/v1/jobs/j-running/events\""));
    assert!(running.contains("/v1/jobs/j-running/preview.png?progress=0.42"));
    assert!(running.contains("/v1/jobs/j-running/cancel") && !running.contains("data-method=\"DELETE\""));
    assert!(done.contains("data-action=\"/v1/jobs/j-succeeded\" data-method=\"DELETE\""));
    assert!(running.contains("name=\"priority\"") && !done.contains("name=\"priority\""), "what is over has no turn");
    let queued = get("/jobs/j-queued").await.body;
    assert!(queued.contains("id=\"waiting\">Every worker &#60;i&#62;left&#60;/i&#62;.</p>"), "{queued}");
    let failed = get("/jobs/j-failed").await.body;
    assert!(failed.contains("/v1/jobs/j-failed/retry") && failed.contains("no triangle &#60;i&#62;left"));
}

#[tokio::test]
async fn the_queue_says_why_each_waits_and_offers_to_move_it() {
    let body = get("/queue").await.body;
    for part in [
        "id=\"turn-j-running\"",
        "a GPU with `&#60;rtx&#62;` in its name",
        "Every worker &#60;i&#62;left&#60;/i&#62;.",
        "2 attempts failed, the last of: the driver &#60;i&#62;crashed",
        "kept from it",
        "data-body='{\"priority\":15}'",
        "data-body='{\"priority\":-5}'",
        "data-action=\"/v1/jobs/j-queued/cancel\"",
    ] {
        assert!(body.contains(part), "no {part}");
    }
}

#[tokio::test]
async fn benchmarks_stand_together_in_the_order_of_a_parameter() {
    let body = get("/benchmarks?by=line_space.n").await.body;
    for part in [
        "64 bunnies &#60;script&#62;: primary &#60;rays&#62;",
        "<option selected>line_space.n</option>",
        "line_space.n = 10: large",
        "data-export=\"csv\"",
        "Speed against error",
        "on the Pareto front",
        "paper: ratio",
        "95 % interval 1.40 to 1.60; the paper: 2.39",
        "class=\"paper\"",
    ] {
        assert!(body.contains(part), "no {part}");
    }
    assert!(!get("/benchmarks?device=none").await.body.contains("<svg viewBox=\"0 0 480"));
    let schedule = get("/farm/schedules").await.body;
    assert!(
        schedule.contains("name=\"run/scenes/box &#60;b&#62;\"") && schedule.contains("The scene &#60;i&#62;is gone")
    );
}

#[tokio::test]
async fn a_webhook_shows_what_became_of_its_messages_and_offers_to_send_them_again() {
    let body = get("/farm/webhooks/w1").await.body;
    for part in [
        "It answered &#60;i&#62;500",
        "generated: cornell &#60;b&#62; at 1db641f",
        "data-action=\"/v1/farm/webhooks/w1/deliveries/de1/resend\"",
        "&#34;type&#34;: &#34;case.changed&#34;",
        "/farm/webhooks/w1?cursor=next%2F1",
    ] {
        assert!(body.contains(part), "no {part}");
    }
    let list = get("/farm/webhooks").await.body;
    assert!(list.contains("href=\"/farm/webhooks/w1\"") && list.contains("value=\"case.slower\""));
}

#[tokio::test]
async fn a_run_shows_its_verdicts_and_offers_to_decide() {
    let all = get("/farm/runs/r1").await.body;
    for part in [
        "id=\"case-cornell\"",
        "id=\"case-teapot\"",
        "verdict-changed",
        "verdict-slower",
        "The pixels differ",
        "Confirmed by running both versions in turns",
        "data-action=\"/v1/farm/runs/r1/approve\"",
        "70,000 of 307,200",
    ] {
        assert!(all.contains(part), "no {part}");
    }
    assert!(all.contains(&format!("/compare?p={0}&#38;p={0}&#38;mode=swipe", fixture::HASH)), "{all}");
    let changed = get("/farm/runs/r1?show=changed").await.body;
    assert!(changed.contains("id=\"case-cornell\"") && !changed.contains("id=\"case-teapot\""));
    let named = get("/farm/runs/r1?q=TEA").await.body;
    assert!(!named.contains("id=\"case-cornell\"") && named.contains("id=\"case-teapot\""));
    let overview = get("/").await.body;
    assert!(overview.contains("1 case waits for a decision"), "{overview}");
    assert!(!get_from(false, "/", &[]).await.body.contains("Regression farm"), "a farm that never ran is not shown");
}

#[tokio::test]
async fn a_variation_starts_from_the_settings_of_its_job() {
    let body = get("/jobs/new?scene=s1&camera=1").await.body;
    assert!(body.contains("<option value=\"1\" selected>1: Top (orthographic)"), "the camera of the link");
    let body = get("/jobs/new?from=j-succeeded").await.body;
    for part in [
        "<option value=\"0\" selected>0: Front (perspective)",
        "<option value=\"@plane\" selected>",
        "data-pointer=\"/settings/lights/0/kind\"",
        "commit=1db641f",
    ] {
        assert!(body.contains(part), "no {part}");
    }
}

/// Pointers of all leaves, with numbers of lists removed.
fn leaves(value: &Value, pointer: &str, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, field)| leaves(field, &format!("{pointer}/{name}"), found))
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            items.iter().for_each(|item| leaves(item, &format!("{pointer}/0"), found));
        }
        _ => {
            found.insert(pointer.to_owned());
        }
    }
}

fn full_settings() -> RenderSettings {
    RenderSettings {
        lights: vec![form::light::new()],
        ground: Some(Ground::default()),
        camera: Some(CameraChoice::Index(0)),
        environment: Some(Environment::Map(EnvironmentMap {
            map: fixture::HASH.to_owned(),
            intensity: 1.0,
            rotation_deg: 0.0,
        })),
        split: Some(Split::Passes(4)),
        acceleration: Acceleration { line_space: Some(LineSpace::default()), ..Acceleration::default() },
        ..RenderSettings::default()
    }
}

fn all_fields(settings: &RenderSettings) -> Vec<Field> {
    let mut fields: Vec<Field> = form::sections(settings, None).into_iter().flat_map(|s| s.fields).collect();
    for (index, light) in settings.lights.iter().enumerate() {
        fields.extend(form::light::fields(&index.to_string(), light));
    }
    fields
}

#[test]
fn the_form_has_a_field_for_every_setting() {
    let settings = full_settings();
    let mut wanted = BTreeSet::new();
    leaves(&serde_json::to_value(&settings).expect("JSON"), "/settings", &mut wanted);
    let offered: BTreeSet<String> = all_fields(&settings).into_iter().map(|field| field.pointer).collect();
    let missing: Vec<_> = wanted.difference(&offered).collect();
    assert!(missing.is_empty(), "no field for {missing:?}");
}

#[test]
fn the_form_offers_every_value_of_every_choice() {
    let document = serde_json::to_value(<Schemas as utoipa::OpenApi>::openapi()).expect("JSON");
    let fields = all_fields(&full_settings());
    let choices = [
        ("/settings/integrator", "Integrator"),
        ("/settings/device", "DeviceChoice"),
        ("/settings/tone_map", "ToneMap"),
        ("/settings/outputs", "Output"),
        ("/settings/aovs", "AovName"),
        ("/settings/acceleration/structure", "StructureKind"),
        ("/settings/acceleration/quality", "BuildQuality"),
        ("/settings/acceleration/line_space/payload", "LineSpacePayload"),
        ("/settings/acceleration/line_space/builder", "LineSpaceBuilder"),
        ("/settings/acceleration/line_space/on_over_budget", "OnOverBudget"),
        ("/settings/acceleration/line_space/ask", "Ask"),
        ("/settings/acceleration/origin_node", "OriginNode"),
        ("/settings/acceleration/adaptive/origin_object", "OriginObject"),
        ("/settings/acceleration/representative/origin_node", "RepresentativeOrigin"),
        ("/settings/lights/0/kind", "LightKind"),
    ];
    for (pointer, schema) in choices {
        let schema = &document["components"]["schemas"][schema];
        let mut wanted = BTreeSet::new();
        collect_names(schema, &mut wanted);
        let field = fields.iter().find(|field| field.pointer == pointer).expect("a field");
        let (Control::Choice { options } | Control::Several { options }) = &field.control else {
            panic!("{pointer} is no choice");
        };
        // An empty value leaves the choice to the service.
        let values = options.iter().map(|option| option.value.trim_matches('"').to_owned());
        let offered: BTreeSet<String> = values.filter(|value| !value.is_empty()).collect();
        assert!(!wanted.is_empty(), "no names in {schema}");
        assert_eq!(offered, wanted, "{pointer}");
    }
}

#[derive(utoipa::OpenApi)]
#[openapi(components(schemas(RenderSettings)))]
struct Schemas;

/// Values of an enum's schema, which lists documented values one by one.
fn collect_names(schema: &Value, names: &mut BTreeSet<String>) {
    let values = schema["enum"].as_array().into_iter().flatten().chain(schema.get("const"));
    names.extend(values.filter_map(Value::as_str).map(str::to_owned));
    for variant in schema["oneOf"].as_array().into_iter().flatten() {
        collect_names(variant, names);
    }
}

#[test]
fn fields_have_unique_ids_and_follow_their_choice() {
    let settings = RenderSettings { integrator: Integrator::Ao, ..full_settings() };
    let fields = all_fields(&settings);
    let ids: BTreeSet<_> = fields.iter().map(|field| field.id.as_str()).collect();
    assert_eq!(ids.len(), fields.len(), "two fields share an id");
    for field in &fields {
        let Some((choice, _)) = &field.only_if else { continue };
        assert!(ids.contains(choice.as_str()), "{} follows {choice}, which is not there", field.id);
    }
    let visible = |pointer: &str| fields.iter().any(|field| field.pointer == pointer && field.visible);
    assert!(visible("/settings/ao_samples") && !visible("/settings/max_bounces"));
    assert!(visible("/settings/split/passes") && !visible("/settings/split/tiles/0"));
}

#[test]
fn filters_of_the_table_become_a_query_of_the_api() {
    let query = |uri: &str| {
        let uri = uri.parse().expect("an address");
        axum::extract::Query::<Filter>::try_from_uri(&uri).expect("filters").0.api_url()
    };
    assert_eq!(query("/jobs"), "/v1/jobs?limit=50&automatic=false");
    assert_eq!(
        query("/jobs?q=&state=failed&scene=s1&label=a%20b%3Dc%3Dd&automatic=true&cursor=x%2Fy"),
        "/v1/jobs?limit=50&state=failed&scene=s1&label.a%20b=c%3Dd&cursor=x%2Fy"
    );
}

#[tokio::test]
async fn the_reference_lists_operations_schemas_and_commands() {
    let body = get("/docs").await.body;
    for part in [
        "id=\"create_job\"",
        "href=\"#schema-NewJob\"",
        "id=\"schema-NewJob\"",
        "curl -X POST &#34;http://farm.example:8080/v1/jobs&#34;",
        "http://farm.example:8080/v1/scenes/$ID",
        "<code>glTF</code>",
        "<code>/problems/invalid-fields</code>",
    ] {
        assert!(body.contains(part), "no {part}");
    }
    for link in body.split("href=\"#").skip(1).map(|rest| rest.split('"').next().unwrap_or_default()) {
        assert!(body.contains(&format!("id=\"{link}\"")), "a link leads to #{link}, which is not there");
    }
}

#[test]
fn units_are_readable() {
    assert_eq!(
        [0.0, 1023.0, 1536.0, 1048570.0, 2e12].map(human_bytes),
        ["0 B", "1023 B", "1.5 KiB", "1.0 MiB", "1.8 TiB"]
    );
    assert_eq!([0.0, 999.0, 1e3, -1234567.0].map(human_count), ["0", "999", "1,000", "-1,234,567"]);
    assert_eq!([9999.0, 12_345.0, 999_600.0, 1.5e9].map(human_short), ["9,999", "12.3 k", "1 M", "1.5 G"]);
    assert_eq!(
        [0.0, 0.0012, 0.34, 12.34, 185.0, 7800.0].map(human_seconds),
        ["0 s", "1.2 ms", "340 ms", "12.3 s", "3 min 05 s", "2 h 10 min"]
    );
    assert_eq!([0.0, 0.001234, 2.0, 12.34, 1234.5].map(human_number), ["0", "0.00123", "2", "12.3", "1,234"]);
    let now: Timestamp = "2026-11-22T12:00:00Z".parse().expect("a time");
    let ago = |text: &str| human_ago(text.parse().expect("a time"), now);
    assert_eq!(ago("2026-11-22T11:59:58Z"), "just now");
    assert_eq!(ago("2026-11-22T12:00:58Z"), "just now", "clocks differ");
    assert_eq!(ago("2026-11-22T11:42:00Z"), "18 min ago");
    assert_eq!(ago("2026-11-19T11:42:00Z"), "3 d ago");
}

#[test]
fn descriptions_become_safe_html() {
    assert_eq!(
        prose_html("As `Vec<T>`; see [`RetryClass`](crate::lease::RetryClass).\n\n<b>"),
        "<p>As <code>Vec&lt;T&gt;</code>; see <code>RetryClass</code>.</p><p>&lt;b&gt;</p>"
    );
}

#[test]
fn addresses_are_escaped() {
    assert_eq!(escape("a/b?c=d&e é"), "a%2Fb%3Fc%3Dd%26e%20%C3%A9");
    assert_eq!(with_query("/x?limit=5", &[("state", ""), ("label", "a=b")]), "/x?limit=5&label=a%3Db");
}
