"""`curlfit profile`: chi squared along one parameter or two, all others refitted."""
