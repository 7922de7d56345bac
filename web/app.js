// Lists the master's jobs. The token comes in the address (lightmill open) and stays in this tab.
const token = new URLSearchParams(location.hash.slice(1)).get("token");
if (token) {
    sessionStorage.setItem("token", token);
    history.replaceState(null, "", location.pathname);
}

function row(job) {
    const cells = [job.job, job.name, job.state,
        job.samples_total > 0 ? Math.floor(100 * job.samples_done / job.samples_total) + " %" : "",
        job.error > 0 ? (100 * job.error).toPrecision(2) + " %" : "-", job.workers];
    const line = document.createElement("tr");
    for (const text of cells) line.insertCell().textContent = text;
    return line;
}

async function refresh() {
    let state = "";
    try {
        const answer = await fetch("/api/v1/jobs",
            { headers: { Authorization: "Bearer " + sessionStorage.getItem("token") } });
        const body = await answer.json();
        if (answer.ok) {
            state = `${body.workers} workers connected, ${body.jobs.length} jobs`;
            document.getElementById("jobs").replaceChildren(...body.jobs.map(row));
        } else
            state = body.detail;
    } catch {
        state = "the master does not answer";
    }
    document.getElementById("state").textContent = state;
}

refresh();
setInterval(() => document.hidden || refresh(), 2000);
