"""`curlfit reproduce`: the claims of Ivanov and Shuvalov (2012), recomputed."""
